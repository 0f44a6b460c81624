"""The hub: an event loop on plain sockets that serves many sessions."""
