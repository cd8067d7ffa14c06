"""The application: patterns, capture, decoding, reconstruction, report and the command line."""
