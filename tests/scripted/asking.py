"""Request a command, and exit with its status: python -ISE asking.py SOCKET COMMAND...; see `tests.shell`."""

import json
import os
import socket
import sys

asked = {"command": sys.argv[2:], "cwd": os.getcwd(), "env": dict(os.environ), "pid": os.getpid()}
with socket.socket(socket.AF_UNIX) as server:
    server.connect(sys.argv[1])
    with server.makefile("rw") as file:
        file.write(f"{json.dumps(asked)}\n")
        file.flush()
        status = int(file.readline())
sys.exit(status)
