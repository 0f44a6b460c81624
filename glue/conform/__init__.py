"""The kit that judges a client in any language: it acts as the hub, a client's only peer."""
