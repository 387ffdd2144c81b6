"""Effects between motor and load, one file each."""
