"""Which sweep would show which effect."""
