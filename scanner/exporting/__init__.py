"""Results in the formats of other programs, in the conventions of each."""
