"""Keys for hubs that others reach over a network: their files, and who may join with which."""
