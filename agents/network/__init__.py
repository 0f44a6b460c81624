"""A small network that has learned to play: the agent `network`, and the file of its weights."""
