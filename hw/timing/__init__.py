"""Assigns frames to pictures: latency calibration, sequential and pipelined acquisition, frame verification."""
