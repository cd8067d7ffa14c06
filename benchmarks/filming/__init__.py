"""Films a simulated room with a camera that nothing synchronises: the player, the projector, a phone, its encoder."""
