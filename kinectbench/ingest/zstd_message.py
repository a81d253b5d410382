"""Messages that are compressed one by one with zstd (`ros2 bag record --compression-mode message`)."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
# A damaged message cannot ask for more than this when it is unpacked.
MAX_MESSAGE_BYTES = 256 << 20


def unpacked_message(data: bytes) -> bytes:
    """A message as it was serialised; empty, which no message is, if it is damaged."""
    if not data.startswith(ZSTD_MAGIC):
        return data
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_MESSAGE_BYTES:
            return b""
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
    except zstandard.ZstdError:
        return b""
