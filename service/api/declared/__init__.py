"""The OpenAPI document beside what the routes make of it: problems as they are sent, roles, descriptions, examples."""
