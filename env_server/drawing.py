"""Names the new place of a module of version 0.1.0."""

raise ModuleNotFoundError(
    "env_server.drawing has moved: write `from env_server.render import drawing`", name="env_server.drawing"
)
