"""Readers of the field's files, one kind per file; each registers itself (:func:`insemu.formats.table.register`)."""
