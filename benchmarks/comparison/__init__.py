"""The commands, files and differences of `compare_results.py`."""
