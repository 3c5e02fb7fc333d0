"""Exams of single steps, one module for each kind: what is asked, and how well it was answered."""
