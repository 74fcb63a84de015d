"""The blind benchmark: cases from the independent robot, sealed labels, answers, score.

The page is docs/evidence/blind.md.
"""
