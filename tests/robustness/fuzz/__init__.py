"""What strangers send, damaged at random: recordings, releases, predictions and tables.

`python tests/robustness/fuzzing.py` runs them. `engine` makes inputs and judges what becomes of them in a
process of its own (`worker`). `damage`, `members` and `places` hold the ways to damage what a file holds,
what is packed in it, and what lies in its place. There is one module for each kind of input.
"""
