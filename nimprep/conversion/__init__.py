"""From a raw dataset to a store: options, plan, one frame's encoding, and the run as a whole."""
