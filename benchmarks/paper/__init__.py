"""The tables and figures of the paper, from simulated captures; `bench_paper.py` starts it."""
