"""What a campaign will measure: poses, sweeps, legs, durations, limits. Nothing here moves."""
