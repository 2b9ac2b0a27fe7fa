"""The store: its format as data, its writer, its reader, what it says of itself, and its checks."""
