"""The paper's synthetic pairs: from CAD meshes or parametric furniture to a release or the authors' files."""
