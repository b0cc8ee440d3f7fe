"""Sources of logs besides files: the simulator with its worlds, and the synchronisation of recorded streams."""
