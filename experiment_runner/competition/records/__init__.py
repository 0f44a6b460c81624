"""Records of the trials of a competition: written, and replayed to verify them."""
