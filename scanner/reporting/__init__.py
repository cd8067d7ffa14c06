"""The parts of the report: what goes in, the verdict, the numbers, the pictures, the plots."""
