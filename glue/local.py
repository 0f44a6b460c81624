"""Names the new place of a module of version 0.1.0."""

raise ModuleNotFoundError("glue.local has moved: write `from glue import local`")
