"""What strangers send, damaged at random: recordings, releases, predictions and tables.

`python benchmarks/fuzzing.py` runs them; `engine` makes inputs and judges what becomes of them in a process
of its own (`worker`), `damage` and `members` hold the ways to damage a file and what is packed in one, and
there is one module for each kind of input.
"""
