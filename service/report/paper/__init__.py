"""Reports on paper: figures as SVG from the same descriptions as on the screen, and the complete report as PDF."""
