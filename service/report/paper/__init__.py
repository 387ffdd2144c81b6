"""Reports on paper: figures as SVG, drawn from the same descriptions as on the screen, and the whole as PDF."""
