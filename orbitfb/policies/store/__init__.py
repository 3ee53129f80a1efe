"""Policies on disk: a directory of tensors and cards, one of them active."""
