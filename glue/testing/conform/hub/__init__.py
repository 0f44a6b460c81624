"""The kit as the hub of one client: connections, exchanges, and the rules by which it is judged."""
