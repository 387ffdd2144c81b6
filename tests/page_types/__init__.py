"""The fields that the scripts of the pages read, checked against docs/reference/openapi.json by TypeScript.

`declarations` writes the types of the API from that document, `compiler` runs the compiler (`checkJs`) on the scripts.
No output of it is committed or served: a page runs as it is written.
"""
