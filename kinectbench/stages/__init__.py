"""The pipeline: ingest, track, fuse, segment, sample_views, pairs, in this order."""
