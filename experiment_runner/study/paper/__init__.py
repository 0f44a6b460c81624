"""The experiments of Mohan (2010), from plan to report. No other folder depends on this one."""
