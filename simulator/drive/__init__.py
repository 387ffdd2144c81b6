"""A CiA 402 axis behind any fieldbus: dictionary, states, modes, measuring function. No I/O and no own clock."""
