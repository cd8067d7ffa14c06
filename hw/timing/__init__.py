"""Which frame is of which picture: latency calibration, sequential and pipelined acquisition, frame verification."""
