"""A run directory: what an experiment stores on disk.

    plan.toml        the plan, resolved; `glue-experiment --plan` reads it
    run.json         command, commit, code version, packages, machine, digests of the user's files
    sources/         copies of those files
    results.sqlite   trials, episodes, voids, events, checkpoints
    lock             held by the process that writes; there is at most one

`Store` writes, one process at a time. `Results` reads, also while a run is under way.
"""
