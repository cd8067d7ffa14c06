"""Readers under fire: files that were changed at random, and what must never come of it."""
