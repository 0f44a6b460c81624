"""The kit that judges a client in any language: it plays the hub, and so all that the client meets."""
