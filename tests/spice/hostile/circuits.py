"""Circuits of others that try to act: spelling by spelling, each with the files that it needs."""

BLOCK = ".control\nshell touch pwned\n.endc\n"
GOOD = """.subckt mine command out ref
Rmine command out 2
Cmine out ref 1e-12
"""
SCENE = """name = "hostile"
include = [{include}]
[kick.drive]
start = "1 us"
width = "2 us"
[kick.driver.user]
subckt = "mine"
[contact]
[sphere]
[solver]
max_step = "1 us"
stop = "5 us"
"""
OUTSIDE = "outside/payload.lib"  # beside the scene's directory


def includes():
    """Include cards: spelling, separator and target crossed."""
    words = (".include", ".INCLUDE", ".Inc", ".includeX", ".incore", "\t.include", "  .inc_x")
    blanks = (" ", "\t", "  \t ", "\x0b", "\x0c")
    targets = (
        f"../{OUTSIDE} extra.lib", f"../{OUTSIDE}", f'"../{OUTSIDE}"', f"'../{OUTSIDE}' ; x",
        "{outside}", "~/payload.lib", "link.lib", "nested.lib", "inner.lib", "./inner.lib $ x",
    )  # fmt: skip
    found = {}
    for i, word in enumerate(words):
        for k, target in enumerate(targets):
            blank = blanks[(i + k) % len(blanks)]
            found[f"include {i} {k} {blank!r}"] = f"{word}{blank}{target}\n"
    return found


def blocks():
    """Everything else that a netlist could act by."""
    shell = "shell touch pwned"
    cards = {
        "control": BLOCK,
        "control in capitals": BLOCK.upper().replace("TOUCH PWNED", "touch pwned"),
        "control by prefix": BLOCK.replace(".control", ".controlled"),
        "control behind a tab": f"\t.control\n\t{shell}\n\t.endc\n",
        "control on one line": f".control {shell}\n.endc\n",
        "control after the end": f".end\n{BLOCK}",
        "control behind a title": f".title x\n{BLOCK}",
        "control in a condition": f".if (1)\n{BLOCK}.endif\n",
        "control behind a carriage return": f"R7 ref 0 1\r.control\r{shell}\r.endc\r",
        "control with Windows line ends": BLOCK.replace("\n", "\r\n"),
        "control behind a zero byte": f"R7 ref 0 1\0\n{BLOCK}",
        "control behind two backslashes": f"R7 ref 0 1 \\\\\n{BLOCK}",
        "control behind a comment with two backslashes": f"* x \\\\\n{BLOCK}",
        "control behind a plus": f"R7 ref 0 1\n+ {BLOCK}",
        "control behind a mark": f"\ufeff{BLOCK}",
        "command comment": f"*#{shell}\n",
        "command comment behind a blank": f"  *#{shell}\n",
        "command comment with blanks": f"*# {shell}\n",
        "command comment in a card": f"R7 ref 0 1\n*#{shell}\n+ \n",
        "script": f"*ng_script\n{shell}\n",
        "bare": f"{shell}\n",
        "bare in the form of a switch": f".subckt q a\n{shell} b c d\n.ends\n",
        "bare in the form of a current switch": ".subckt q a\nwrite pwned a V1 d\n.ends\n",
        "bare in the form of a source": ".subckt q a\nexec touch pwned b c 1\n.ends\n",
        "bare load in the form of a coil": ".subckt q a\nload inner.lib a 1m\n.ends\n",
        "bare source in the form of a switch": ".subckt q a\nsource inner.lib a b c d\n.ends\n",
        "exec": f".exec {shell}\n",
        "library": ".lib inner.lib evil\n",
        "library in capitals": ".LIB 'inner.lib' evil\n",
        "library by prefix": ".library inner.lib evil\n",
        "library behind a tab": f".lib\t../{OUTSIDE}\tevil\n",
        "include behind two backslashes": "R7 ref 0 1 \\\\\n.include inner.lib\n",
        "include behind a card": "R7 ref 0 1\n.include inner.lib\n+ 1\n",
        "include in a subcircuit of its own": ".subckt q a\n.include inner.lib\n.ends\n",
        "include with a zero byte": ".include inner.lib\0x\n",
        "code model": "codemodel ./inner.lib\n",
        "code model command": ".codemodel ./inner.lib\n",
        "OSDI": ".osdi ./inner.lib\n",
        "pre_osdi": "pre_osdi ./inner.lib\n",
        "file source": '.model f filesource (file="inner.lib")\nA1 %v([ref]) f\n',
        "process": '.model p d_process (process_file="touch pwned")\nA1 [ref] ref ref [q] p\n',
        "waveform file": 'V8 q 0 PWL file="inner.lib"\nR8 q 0 1\n',
        "file split over two lines": 'V8 q 0 PWL\n+ file\n+ ="inner.lib"\nR8 q 0 1\n',
        "back quotes": ".save `touch pwned`\n",
        "back quotes in a value": "R9 ref 0 `touch pwned`\n",
        "output to a file": ".print tran v(q) > pwned\n",
        "saved operating point": ".savebias pwned\n",
        "debug output": ".options ngdebug\n",
        "raw file": ".options rawfile=pwned addcontrol\n",
        "editor": ".options editor=./pwned\n",
    }  # fmt: skip
    return cards


def honest():
    """Circuits that must run; a program that refuses everything fails here."""
    names = ".subckt q a\nCd a 0 1n\nLoad a 0 1m\nExit b 0 a 0 2\nRb b 0 1\n.ends\n"
    return "* nothing\n", ".include\textra.lib\n", '.INC "extra.lib" ; x\n', names


def names():
    """Names in the scene itself; files of those names exist where a name may be one."""
    return {
        "line break": f"extra.lib\n.control\n{'shell touch pwned'}\n.endc\n*.lib",
        "carriage return": "extra.lib\r.control\rshell touch pwned\r.endc\r*.lib",
        "parent": f"../{OUTSIDE}",
        "absolute": "{outside}",
        "home": "~/payload.lib",
        "link": "link.lib",
        "folder with a parent": f"folder/../../{OUTSIDE}",
        "blank": "user.lib inner.lib",
        "quote": 'user.lib" "inner.lib',
        "semicolon": "user.lib;inner.lib",
    }


def write_all(root):
    """Write every variant into a directory of its own below ``root``; return their scenes."""
    outside = root / OUTSIDE
    outside.parent.mkdir()
    payload = f"{BLOCK}.lib evil\n{BLOCK}.endl\n"
    outside.write_text(BLOCK)
    (root / "home").mkdir()
    (root / "home" / "payload.lib").write_text(BLOCK)
    cards = {**includes(), **blocks()}
    variants = [("user.lib", card) for card in (*honest(), *cards.values())]
    variants += [(name, "") for name in names().values()]
    scenes = []
    for i, (name, card) in enumerate(variants):
        home = root / f"v{i:03d}"
        home.mkdir()
        name, card = (text.replace("{outside}", str(outside)) for text in (name, card))
        (home / "inner.lib").write_text(payload if ".lib" in card[:6].lower() else BLOCK)
        (home / "nested.lib").write_text(f"* nested\n.include\t../{OUTSIDE}\n")
        (home / "extra.lib").write_text("* extra\n")
        (home / "link.lib").symlink_to(outside)
        text = GOOD + ".ends mine\n" + card
        (home / "user.lib").write_bytes(text.encode())
        if "/" not in name and not (home / name).exists():
            (home / name).write_text(GOOD + ".ends mine\n")
        quoted = name.replace("\\", "\\\\").replace('"', '\\"')
        quoted = quoted.replace("\n", "\\n").replace("\r", "\\r")
        scene = home / "hostile.toml"
        scene.write_bytes(SCENE.replace("{include}", f'"{quoted}"').encode())
        (home / "bare.cir").write_text(
            "* as the simulator would take it alone\n.include "
            f"{name}\nV1 command 0 1\nX1 command out 0 mine\nR1 out 0 1\n.tran 1u 5u\n.end\n"
        )
        scenes.append(scene)
    return scenes
