"""Interface to real drives, in SI units on the joint side. Contains nothing about robots or identification."""
