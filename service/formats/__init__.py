"""Files of other programs: traces, makers' robots, exports."""
