"""`glue-compete`: a competition of untrusted agents, from one file to verified standings."""
