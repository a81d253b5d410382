"""Make datacite.json: the metadata of a release in DataCite's schema 4, for registries of DOIs.

The content can be sent as `attributes` to `POST https://api.datacite.org/dois`; Zenodo and others export the
same.
"""

from kinectbench.core.artefacts.benchmark import UNSPECIFIED
from kinectbench.release.publish.about import SUBJECTS, About
from kinectbench.release.publish.attribution import HUGGING_FACE, authors, license_url

SCHEMA = "http://datacite.org/schema/kernel-4"
FORMATS = ("application/x-npz", "image/png", "application/json", "model/gltf-binary")


def datacite(about: About) -> dict[str, object]:
    """Return the content of datacite.json.

    Source: DataCite Metadata Schema 4.5, https://datacite-metadata-schema.readthedocs.io/en/4.5/
    """
    citation = about.citation
    content: dict[str, object] = {
        "schemaVersion": SCHEMA,
        "creators": [_creator(author) for author in authors(citation, about.name)],
        "titles": [{"title": citation.title or about.name}],
        "publisher": {"name": f"The makers of {about.name}"},
        "publicationYear": about.date[:4],
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "benchmark"},
        "subjects": [{"subject": subject} for subject in SUBJECTS],
        "dates": [{"date": about.date, "dateType": "Issued"}],
        "formats": list(FORMATS),
        "descriptions": [{"description": about.description, "descriptionType": "Abstract"}],
    }
    for key in ("doi", "version", "url"):
        if value := getattr(citation, key):
            content[key] = value
    if about.license != UNSPECIFIED:
        content["rightsList"] = [_rights(about.license)]
    return content


def _rights(license: str) -> dict[str, str]:
    rights = {"rights": license}
    if license in HUGGING_FACE:
        rights |= {"rightsIdentifier": license, "rightsIdentifierScheme": "SPDX"}
        rights |= {"schemeUri": "https://spdx.org/licenses/", "rightsUri": str(license_url(license))}
    return rights


def _creator(author: str) -> dict[str, str]:
    """Return an author's DataCite entry: `Family, Given` is a person, any other name is a group."""
    family, comma, given = author.partition(", ")
    if not comma:
        return {"name": author, "nameType": "Organizational"}
    return {"name": author, "nameType": "Personal", "familyName": family, "givenName": given}
