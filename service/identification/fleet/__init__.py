"""Estimates of many robots over many campaigns: which robot has changed, which differs from its siblings. Pure."""
