"""Measurements of a Sinumerik's own optimisation tool: frequency responses and automatic servo tuning, as XML.

`members` reads the file within bounds, `base85` its number arrays, `measurement` and `tuning` say what is in it,
`document` what it tells of the axis, in the models of `told`. Nothing is known of the format but what files show; what
is not read is told.
"""
