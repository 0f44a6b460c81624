"""Numbers of finished trials."""
