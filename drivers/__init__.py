"""Talks to real drives, in SI units on the joint side. Knows nothing of robots or identification."""
