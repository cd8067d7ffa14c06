"""What developers of this repository run beside its commands; scripts may also be run by their path."""
