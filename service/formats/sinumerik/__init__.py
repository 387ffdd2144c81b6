"""Measurements of the optimisation tool of a Sinumerik: frequency responses and automatic servo tuning, as XML.

`members` reads the file with size limits, `measurement` interprets it, `document` computes the results for the axis.
The format is only known from existing files; the parts of a file that are not read are listed.
"""
