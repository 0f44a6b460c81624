"""The studies behind tables of the documents: programs of the repository, which are not installed."""
