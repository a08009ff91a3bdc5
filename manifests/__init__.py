"""The contract on disk between the factory, which renders, and the networks, which learn."""

from pathlib import Path

JOBS = Path(__file__).resolve().parent / "jobs"  # jobs that come with the program
RUNS = Path(__file__).resolve().parent / "runs"  # training runs that come with the program
