"""What everything else stands on: errors, checks of arguments, files, memory, options, progress, optional packages.

- `errors`: `InputError`
- `checks`: checks of arguments, and hints for misspelt names
- `files`: files that are written whole or not at all, locks, and temporary names
- `memory`: the memory that is available, and limits on what is read
- `progress`: progress of long work
- `extras`: optional packages, and plug-ins
- `option_fields`: signatures, docstrings and command-line options derived from the fields of options
- `field_docs`: docstrings of the fields of results
- `wings`: what the wings add to the core, by name
- `command_registry`: where each command is defined
- `pickles`: what travels in pickles, and in fewer bytes
- `forks`: what becomes of threads and files in a forked process
"""
