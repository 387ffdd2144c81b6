"""Geometry of the robot in its cell: hulls, collisions, obstacles."""
