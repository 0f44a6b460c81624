"""The kit that judges a client in any language: it acts as the hub, which is all that a client talks to."""
