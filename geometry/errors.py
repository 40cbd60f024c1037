"""The one exception for geometry that cannot be used."""


class GeometryError(ValueError):
    """A curve, file or grid cannot be used; the message says which, what is wrong and what to do."""
