"""The kit as the hub of one client: connections, exchanges, rules, and the mirror."""
