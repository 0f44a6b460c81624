"""Names the new place of a module of version 0.1.0."""

raise ModuleNotFoundError(
    "env_server.batch has moved: write `from env_server.mario.batch import Batch`", name="env_server.batch"
)
