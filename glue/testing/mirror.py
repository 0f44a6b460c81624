"""Run the mirror: `python -m glue.testing.mirror agent|environment|experiment [--libzmq]`."""

from __future__ import annotations

import sys

from glue.conform.clients.mirror import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
