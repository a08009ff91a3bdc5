"""How much work a call is, as a number that does not depend on the machine or on what else it does.

Seconds are measured by tests/endurance/timings.py, where a busy machine fails no test.
"""

import sys


def calls(function):
    """The number of Python functions entered while `function` runs, generators' steps included."""
    count, before = 0, sys.getprofile()

    def profile(frame, event, argument):
        nonlocal count
        count += event == "call"

    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count
