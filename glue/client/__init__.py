"""A peer's connection to a hub: players that are served, and the remote experiment."""
