"""The kit as the peers of a hub: scripted peers, and the scenes that they play."""
