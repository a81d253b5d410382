"""Networks that complete shapes: the paper's five methods and a small one; trained, run, and converted."""
