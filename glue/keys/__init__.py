"""Keys for hubs that others reach over a network: key files, and the roles permitted to each key."""
