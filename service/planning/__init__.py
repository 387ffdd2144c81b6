"""Plans of campaigns: poses, sweeps, legs, durations, limits. Nothing here moves the robot."""
