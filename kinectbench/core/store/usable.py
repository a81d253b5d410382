"""What a store needs before anything is asked of it: obstore, a bucket, an endpoint that is a URL."""

import os
import re
from urllib.parse import urlsplit

from kinectbench.core.errors import SettingsError
from kinectbench.core.store.address import unusable
from kinectbench.core.untrusted import printable

MISSING = "needs obstore; run pip install 'kinectbench[cluster]'"
# What the Rust crate object_store reads; an endpoint that is no URL makes it panic.
ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")


def require_usable(url: str, place: str) -> None:
    """Refuse what no attempt would change.

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
    if said := unusable(url):
        raise SettingsError(said, what="bad-url")
    for name in ENDPOINTS if scheme in ("s3", "s3a") else ():
        endpoint = os.environ.get(name, "")
        if endpoint and not _is_endpoint(endpoint):
            said = printable(_without_user(endpoint), 80)
            raise SettingsError(
                f"{name}={said}: must begin with http:// or https:// and name a host", what="bad-environment"
            )


def _is_endpoint(text: str) -> bool:
    """Whether a client can send requests there."""
    try:
        found = urlsplit(text)
        _ = found.port
    except ValueError:
        return False
    return bool(re.match(r"https?://[!-~]+$", text)) and bool(found.hostname)


def _without_user(text: str) -> str:
    return text.rpartition("@")[2]
