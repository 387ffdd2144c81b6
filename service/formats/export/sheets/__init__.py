"""The sheet: values to enter into a control, its page, and the comparison with a later measurement."""
