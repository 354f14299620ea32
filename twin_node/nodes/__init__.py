"""Thin nodes that wire the rooms to topics, and the chains made of them."""
