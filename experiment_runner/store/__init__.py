"""What an experiment leaves behind: a run directory.

    plan.toml        the plan, resolved; `glue-experiment --plan` reads it
    run.json         code version, packages, machine
    results.sqlite   trials, episodes, voids, events, checkpoints
    lock             held by the one process that writes

`Store` writes, one process at a time; `Results` reads, at any time, also while a run goes on.
"""
