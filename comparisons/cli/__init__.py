"""The command line ``slam-compare``: `app` joins the verbs, each of which has a module of its own."""

from .verbs import app, main

__all__ = ["app", "main"]
