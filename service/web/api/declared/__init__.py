"""Additions to the OpenAPI document of the routes: problems as they are sent, roles, descriptions, examples."""
