"""Sockets, as a hub and its peers use them alike."""
