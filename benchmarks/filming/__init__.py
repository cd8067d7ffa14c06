"""Films of a simulated room by an unsynchronised camera: player, projector, phone, encoder."""
