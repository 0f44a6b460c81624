"""The page of runs that `glue-view` serves: its server, and in `static/` what runs in the browser."""
