"""Networks that complete shapes (the paper's five and a small one): training, prediction, conversion."""
