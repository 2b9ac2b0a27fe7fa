"""What is computed from depth: a checked public function per module, kernels beneath."""
