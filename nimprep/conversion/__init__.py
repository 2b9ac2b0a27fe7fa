"""From a data set to a store; docs/architecture.md says in which order these files are read."""
