"""The command `twin_node`."""
