"""The paper's tables and figures from simulated captures; `bench_paper.py` runs it."""
