"""The page of runs that `glue-view` serves: its server, and in `static/` its files for the browser."""
