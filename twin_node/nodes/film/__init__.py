"""A log as a film or a picture: what the cameras saw, what the twin made of it, where it errs, what it foresaw."""

from twin_node.nodes.film.film import VIEWS, Film
from twin_node.nodes.film.writer import PICTURES, FilmError, write_film, write_picture

__all__ = ["PICTURES", "VIEWS", "Film", "FilmError", "write_film", "write_picture"]
