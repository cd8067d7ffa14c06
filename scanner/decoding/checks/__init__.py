"""Checks of the coordinates, and what they lead to: a refusal, a finding, or advice for the operator."""
