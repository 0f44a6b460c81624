"""A peer's connection to a hub: served players, and the remote experiment."""
