"""The independent recomputations in benchmarks/ are references here."""
