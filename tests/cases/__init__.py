"""What people ran into, rebuilt small: each case's right value, kind by kind."""
