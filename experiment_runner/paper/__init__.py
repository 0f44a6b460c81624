"""The experiments of Mohan (2010), from plan to report. Nothing outside this folder needs it."""
