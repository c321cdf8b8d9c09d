"""How the names of files end that stand for components."""

FORM = ".form.json"
"""The specification of a form (`models.components.correction`)."""
