"""Requirements of a store before the first request: obstore, a bucket, an endpoint that is a URL."""

import os
import re
from urllib.parse import urlsplit

from kinectbench.core.errors import SettingsError
from kinectbench.core.store.address import unusable
from kinectbench.core.untrusted import printable

MISSING = "needs obstore; run pip install 'kinectbench[cluster]'"
# Variables that the Rust crate object_store reads; it panics if an endpoint is no URL.
ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")


def require_usable(url: str, place: str) -> None:
    """Refuse errors that a retry cannot change.

    Args:
        url: of the store.
        place: the URL that the error names.

    Raises:
        SettingsError: obstore is not installed, the URL has no bucket or host, or the endpoint is no URL.
    """
    try:
        import obstore  # noqa: F401
    except ImportError:
        raise SettingsError(f"{place}: {MISSING}", what="no-package") from None
    scheme = url.partition(":")[0]
    if text := unusable(url):
        raise SettingsError(text, what="bad-url")
    for name in ENDPOINTS if scheme in ("s3", "s3a") else ():
        endpoint = os.environ.get(name, "")
        if endpoint and not _is_endpoint(endpoint):
            text = printable(_without_user(endpoint), 80)
            raise SettingsError(
                f"{name}={text}: must begin with http:// or https:// and name a host", what="bad-environment"
            )


def _is_endpoint(text: str) -> bool:
    """Whether an endpoint is a usable URL."""
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        return False
    return bool(re.match(r"https?://[!-~]+$", text)) and bool(parts.hostname)


def _without_user(text: str) -> str:
    return text.rpartition("@")[2]
