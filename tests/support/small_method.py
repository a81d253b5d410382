"""What a network learns from in seconds: a few pairs of simple shapes, and a configuration."""

from synthetic_release import Recordings

RECORDINGS: Recordings = (
    # id, category, object, split, number of views
    ("chair_01", "chair", "chair_a", "train", 3),
    ("table_01", "table", "table_a", "train", 2),
    ("chair_02", "chair", "chair_b", "validation", 1),
    ("chair_03", "chair", "chair_c", "test", 2),
)
TINY = """\
name: tiny
network: {kind: 3d-recae, channel_divisor: 32, output_cells: 64}
loss: {kind: cross-entropy, unknown: mask}
training: {batch: 2, epochs: 2, learning_rate: 3.0e-3, validate_every_steps: 2, validation_pairs: 1}
"""
