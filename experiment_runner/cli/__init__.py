"""The commands around experiments; each is a thin layer over the package."""
