"""Scripts by which shells complete commands, options and their values."""

from collections.abc import Iterable, Sequence

from tisfm.checks import hint
from tisfm.cli.known_options import LISTS, OF_TISFM, SHELLS, Known, takes_numbers, values_in
from tisfm.errors import InputError

_BASH = """\
_tisfm() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
  local given="${{COMP_WORDS[1]}}" kept=""
  COMPREPLY=()
  if [ "$COMP_CWORD" -eq 1 ]; then
    words="{first}"
  elif [ "$before" = "--completion" ]; then
    words="{shells}"
  else
    case "$given $before" in
{values}
      *)
        case "$current" in
          -*)
            case "$given" in
{options}
            esac
            ;;
        esac
        ;;
    esac
  fi
  if [ -n "$words" ]; then
    COMPREPLY=( $(compgen -P "$kept" -W "$words" -- "${{current#"$kept"}}") )
  fi
}}
complete -o default -F _tisfm tisfm
"""
_KEPT = 'kept="${current%"${current##*,}"}"'  # of a list with commas, all but its last word
_FIRST = "complete -c tisfm -n __fish_use_subcommand"
_ZSH = """\
autoload -U +X compinit && compinit -u
autoload -U +X bashcompinit && bashcompinit
"""


def completion_script(shell: str, known: Known) -> str:
    """Return a script that a shell reads at its start.

    Parameters
    ----------
    shell : {"bash", "zsh", "fish", "tcsh"}
    known : Known

    Raises
    ------
    ValueError
        If it is another shell.
    """
    if shell not in SHELLS:
        raise InputError(
            f"--completion is {shell!r}{hint(shell, SHELLS)}: expected {', '.join(SHELLS)}"
        )
    if shell == "tcsh":
        return _tcsh(known)
    if shell == "fish":
        return _fish(known)
    return (_ZSH if shell == "zsh" else "") + _bash(known)


def _bash(known: Known) -> str:
    values = [
        f'      "{command} {option}") words="{" ".join(chosen)}" ;;'
        for command, options in known.options.items()
        for option, chosen in options.items()
        if chosen
    ]
    values += [
        f'      "{command} {option}") words="{" ".join(chosen)}" {_KEPT} ;;'
        for command, options in LISTS.items()
        for option, chosen in options.items()
    ]
    options = [
        f'              {command}) words="{_joined(taken)}" ;;'
        for command, taken in known.options.items()
    ]
    return _BASH.format(
        first=" ".join((*known.commands, *OF_TISFM)),
        shells=" ".join(SHELLS),
        values="\n".join(values),
        options="\n".join(options),
    )


def _fish(known: Known) -> str:
    """Return a line for the commands and for every option: fish asks of each whether it fits."""
    first = {**dict.fromkeys(OF_TISFM, ""), "--completion": f"{{{','.join(SHELLS)}}}"}
    lines = [f"{_FIRST} -f -a '{' '.join(known.commands)}'"]
    lines += [f"{_FIRST} {_fish_option(name, shape)}" for name, shape in first.items()]
    for command, options in known.shapes.items():
        several = LISTS.get(command, {})
        lines += [
            f"complete -c tisfm -n '__fish_seen_subcommand_from {command}' "
            + _fish_option(name, shape, several.get(name, ()))
            for name, shape in options.items()
        ]
    return "\n".join(lines) + "\n"


def _fish_option(name: str, shape: str, several: Sequence[str] = ()) -> str:
    """Return an option as fish has it: alone, or with words, a number or a file after it."""
    told = f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}"
    if several:
        return f"{told} -x -a '(__fish_append , {' '.join(several)})'"
    values = values_in(shape)
    if values:
        return f"{told} -x -a '{' '.join(values)}'"
    if not shape:
        return told
    return f"{told} -x" if takes_numbers(shape) else f"{told} -r"


def _tcsh(known: Known) -> str:
    """Return one line: tcsh does not know which command an option is given to."""
    chosen: dict[str, dict[str, None]] = {}
    for command, options in known.options.items():
        for option, values in {**options, **LISTS.get(command, {})}.items():
            if option.startswith("--"):
                chosen.setdefault(option, {}).update(dict.fromkeys(values))
    after = [f"'n/{option}/({' '.join(values)})/'" for option, values in chosen.items() if values]
    names = [option.removeprefix("--") for option in (*chosen, "--version", "--completion")]
    parts = [
        *after,
        f"'n/--completion/({' '.join(SHELLS)})/'",
        f"'c/--/({' '.join(dict.fromkeys(names))})/'",
        f"'p/1/({' '.join(known.commands)})/'",
        "'p/*/f/'",
    ]
    return f"complete tisfm {' '.join(parts)}\n"


def _joined(options: Iterable[str]) -> str:
    return " ".join(option for option in options if option.startswith("--"))
