"""Where the robot is in its cell: hulls, collisions, what stands around it."""
