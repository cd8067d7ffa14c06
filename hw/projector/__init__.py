"""The projector: a window that covers one of the computer's screens, in a process of its own."""
