"""Output for people: glue/console.py."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """
import threading
from glue.console import say

def print_lines(letter):
    for _ in range(200):
        say(40 * letter)

threads = [threading.Thread(target=print_lines, args=(letter,)) for letter in "abcd"]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def test_lines_of_several_threads_stay_whole_without_a_buffer() -> None:
    command = [sys.executable, "-u", "-c", _PROGRAM]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stderr.splitlines()
    assert sorted(lines) == [40 * letter for letter in "abcd" for _ in range(200)]
