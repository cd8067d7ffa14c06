"""The diagrams of the documentation; docs/make_diagrams.py writes them."""
