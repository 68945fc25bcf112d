"""Rules that hold across all packages (docs/explanation/architecture.md)."""

import ast
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from vb_testing import TOP, run_command
from vb_core import names, sentences
from vb_core.interaction_tables import COMMANDS

FEATURES = "vb_laser_detect vb_fusion vb_map_integration vb_interaction vb_voice_wizard vb_robot vb_feedback vb_web vb_mqtt".split()
FILE_SUFFIXES = "crt csv html json jsonl key launch npz pgm py sh test xml yaml".split()
PACKAGES = sorted(path.parent.name for path in TOP.glob("src/*/package.xml"))


def python_files():
    programs = ("src/*/scripts/*", "scripts/demo", "scripts/film", "scripts/reference", "scripts/test")
    return [TOP / name for name in listed_by_git("*.py", *programs)]


def run_python(*arguments):
    """Runs Python in a process of its own, which has to succeed."""
    done = run_command(sys.executable, *arguments)
    assert done.returncode == 0, done.stdout


def listed_by_git(*given):
    """Lists the repository's files as `git ls-files` does, if they are on disk."""
    listed = run_command("git", "ls-files", *given, cwd=TOP, check=True).stdout
    return [name for name in listed.splitlines() if (TOP / name).is_file()]


def imported(path):
    """Returns the names of the top-level packages that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("path", python_files(), ids=lambda path: str(path.relative_to(TOP)))
def test_syntax_is_that_of_python_3_8(path):
    # ROS Noetic's version; the interpreter that runs the tests may be newer
    ast.parse(path.read_text(encoding="utf-8"), filename=str(path), feature_version=(3, 8))


@pytest.mark.parametrize("package", [*FEATURES, "vb_core"])
def test_feature_packages_do_not_import_each_other(package):
    allowed = {package, "vb_core", "vb_msgs"}
    for path in TOP.glob(f"src/{package}/src/**/*.py"):
        others = {name for name in imported(path) if name.startswith("vb_")} - allowed
        assert not others, f"{path.relative_to(TOP)} imports {others}"


@pytest.mark.parametrize("package", [*FEATURES, "vb_core", "vb_sim", "vb_evaluation"])
def test_manifests_name_what_is_imported(package):
    manifest = ElementTree.parse(str(TOP / "src" / package / "package.xml"))
    named = {element.text for element in manifest.getroot() if element.tag.endswith("depend")}
    for path in TOP.glob(f"src/{package}/src/**/*.py"):
        ours = {name for name in imported(path) if name.startswith("vb_") or name.endswith("_msgs")}
        missing = ours - named - {package}
        assert not missing, f"{path.relative_to(TOP)} imports {missing}, which package.xml does not name"


# ------------------------------------------------------------ pure modules
ROS = "rospy roslib rosgraph rosbag roslaunch tf2_ros cv_bridge actionlib message_filters".split()
ROS += ["dynamic_reconfigure", "interactive_markers"]
ARCHITECTURE = (TOP / "docs/explanation/architecture.md").read_text(encoding="utf-8")
PROMISED = re.findall(r"^\| \[`(vb_[\w.]+)`\]", ARCHITECTURE, re.M)
ALGORITHMS = re.findall(r"src/(vb_\w+)/src", (TOP / "pyproject.toml").read_text(encoding="utf-8"))
# nodes' helpers and programs that are neither nodes nor in a folder `ros/`
CONNECTED_TO_ROS = """
vb_bringup.check_lab vb_bringup.check_launch vb_bringup.try_camera
vb_evaluation.demo vb_evaluation.simulated_study.live_run vb_evaluation.user_study.recording
vb_evaluation.navigation_check.check_navigation vb_evaluation.navigation_check.move_base_goals
vb_evaluation.system_observer vb_map_integration.border_messages vb_map_integration.import_borders
vb_mqtt.entities vb_sim.in_process_ros.connections vb_sim.in_process_ros.launch_file vb_sim.in_process_ros.rospy_stand_in
vb_interaction.border_preview vb_interaction.border_services vb_interaction.state_message
vb_voice_wizard.wizard_console vb_web.action_executor vb_web.camera_images vb_web.page_messages
""".split()
EXAMPLES_AS_INSTALLED = """
import doctest, importlib, sys
sys.path.insert(0, sys.argv[1])
for name in ("rospy", "roslib", "tf2_ros", "vb_msgs", "std_msgs", "av", "simplejpeg"):
    sys.modules[name] = None
for name in sys.argv[2:]:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.argv[1]), module.__file__
    done = doctest.testmod(module)
    assert done.attempted and not done.failed, name
"""
IMPORT_WITHOUT = """
import importlib, sys
sys.modules.update(dict.fromkeys(sys.argv[1].split(",")))
for module in sys.argv[2:]:
    importlib.import_module(module)
"""


def module_name(path):
    parts = path.relative_to(TOP / "src").with_suffix("").parts[2:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def may_need_ros(path):
    """Returns whether a file's place allows it to need ROS; all others have to work without."""
    return path.stem.endswith("_node") or path.parent.name == "ros" or module_name(path) in CONNECTED_TO_ROS


@pytest.mark.parametrize("package", [name for name in PACKAGES if (TOP / "src" / name / "src").exists()])
def test_pure_modules_load_without_ros(package):
    files = [path for path in TOP.glob(f"src/{package}/src/{package}/**/*.py") if path.stem != "__main__"]
    modules = sorted(module_name(path) for path in files if not may_need_ros(path))
    assert {name for name in PROMISED if name.split(".")[0] == package} <= set(modules)
    messages = {name for path in python_files() for name in imported(path) if name.endswith("_msgs")}
    run_python("-c", IMPORT_WITHOUT, ",".join([*ROS, *messages]), *modules)


# ------------------------------------------------------------ launch files and reference
def test_parameters_removed_from_a_launch_file_are_gone():
    # parameters outlive their nodes on the master: a misspelt one would end its node until the master is restarted
    kept = []
    for path in sorted(TOP.glob("launch/**/*.launch")):
        for node in ElementTree.parse(str(path)).getroot().iter("node"):
            if node.get("pkg", "").startswith("vb_") and node.get("clear_params") != "true":
                kept.append(f"{path.relative_to(TOP)}: {node.get('name')}")
    assert not kept


def test_reference_is_that_of_the_code():
    run_python(TOP / "scripts" / "reference", "--check")


def test_docstrings_name_their_nodes_fixed_topics():
    reference = runpy.run_path(str(TOP / "scripts" / "reference"))
    missing = []
    for package, entries in reference["find_executables"]().items():
        for executable, docstring in entries:
            source = reference["find_source"](TOP / "src" / package / "scripts" / executable, package)
            if not source.stem.endswith("_node"):
                continue  # a command that ends on its own
            for used in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
                if isinstance(used, ast.Attribute) and getattr(used.value, "id", "") == "names":
                    name = getattr(names, used.attr)
                    if used.attr != "MAP_FRAME" and not re.search(rf"{re.escape(name)}(?![\w/])", docstring):
                        missing.append(f"{executable}: {name}")
    assert not missing


def test_the_table_of_topics_has_every_fixed_name():
    table = (TOP / "docs" / "reference" / "topics.md").read_text(encoding="utf-8")
    fixed = {value for key, value in vars(names).items() if key.isupper() and key != "MAP_FRAME"}
    assert not fixed - set(re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE))


# ------------------------------------------------------------ words
def calls(source):
    """Lists the calls in a program's text: (name, arguments, keyword arguments)."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    names_called = [getattr(node.func, "attr", getattr(node.func, "id", "")) for node in nodes]
    keywords = [{keyword.arg: keyword.value for keyword in node.keywords} for node in nodes]
    return list(zip(names_called, (node.args for node in nodes), keywords))


def own_sentences(source):
    """Lists the catalogue's codes that a file raises or reports with a sentence of its own."""
    given_one = [
        given[0]
        for name, given, named in calls(source)
        if (name.endswith("Error") and len(given) > 1)
        or (name == "Notice" and given and isinstance(named.get("message"), (ast.Constant, ast.JoinedStr)))
    ]
    return [code.value for code in given_one if getattr(code, "value", None) in sentences.catalog()]


def test_the_page_of_commands_has_each_of_them():
    page = (TOP / "docs/reference/commands.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"`{name}`" not in page] == []


def test_a_code_has_one_sentence():
    files = [path for pattern in ("src/*/src/**/*.py", "bench/**/*.py", "scripts/*.py") for path in TOP.glob(pattern)]
    sources = {path.relative_to(TOP): path.read_text(encoding="utf-8") for path in files}
    doubles = [f"{path}: {code}" for path, source in sources.items() for code in own_sentences(source)]
    assert not doubles, "\n".join(["the sentence for a code stands in vb_core/languages; pass its values", *doubles])
    assert own_sentences("raise CodedError('no_map', f'no map in {folder}')") == ["no_map"]
    assert own_sentences("Notice('robot_inside', message=f'{robot} is in it')") == ["robot_inside"]


def test_every_code_gives_its_sentence_all_values():
    used = set()
    missing = []
    for path in TOP.glob("src/*/src/**/*.py"):
        source = path.read_text(encoding="utf-8")
        for name, given, named in calls(source):
            alone = name in ("Notice", "warn", "warning") or (name.endswith("Error") and len(given) == 1)
            used.update(code.value for code in given[:1] if alone and isinstance(code, ast.Constant))
            sentence = sentences.catalog().get(getattr(given[0], "value", None)) if given else None
            if sentence and name.endswith("Error") and len(given) == 1 and None not in named:
                passed = {value.replace("_code", "") for value in named}
                wanted = set(re.findall(r"{(\w+)", sentence)) - {"camera", *passed}  # the notice names the camera
                missing += [f"{path}: {value} of {given[0].value}" for value in wanted]
        pattern = r'"(lab_\w+)"' if path.name == "lab_readiness.py" else r'_code"?[:=] ?"(\w+)"'
        used.update(re.findall(pattern, source))
    codes = {code for code in used if re.fullmatch("[a-z0-9]+(_[a-z0-9]+)+", str(code))}
    assert len(codes) > 100
    assert codes <= set(sentences.catalog())
    assert not missing, missing


def texts():
    """Lists the files that people read: code, interfaces, documentation, messages."""
    kinds = ("*.py", "*.md", "*.yaml", "*.launch", "*.msg", "*.srv", "*.js")
    listed = listed_by_git(*kinds, "scripts", "src/*/scripts/*")
    return [TOP / name for name in listed if "/languages/" not in name or "/en/" in name]


def test_links_lead_somewhere():
    broken = []
    for path in texts():
        text = path.read_text(encoding="utf-8")
        links = re.findall(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)", text) if path.suffix == ".md" else ()
        places = [path.parent / target for target in links if not re.match(r"[a-z]+:", target)]
        places += [TOP / page for page in re.findall(r"(?<!:)\bdocs/[\w/-]+\.md", text)]
        broken += [f"{path.relative_to(TOP)}: {place}" for place in places if not place.exists()]
    assert not broken, broken


def definitions():
    """Returns what each module of the project defines, by the module's name, which several packages may share."""
    defined = {}
    for path in python_files():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = (target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets)
        names_in = {node.name for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        names_in |= {target.id for target in constants if isinstance(target, ast.Name)}
        defined.setdefault(path.stem, set()).update(names_in)
    return defined


def test_names_of_modules_in_texts_are_right():
    """A file or a module's definition that a docstring, a comment or a page names between backticks exists."""
    defined = definitions()
    wrong = []
    for path in (path for path in texts() if path.suffix in (".py", ".md")):
        text = path.read_text(encoding="utf-8")
        wrong += [f"{path}: {name}" for name in re.findall(r"`(?:[\w/]+/)?(\w+)\.py`", text) if name not in defined]
        for module, name in re.findall(r"`([a-z_]+)\.([A-Za-z_]\w*)(?:\(\))?`", text):
            is_known = name in defined.get(module, ()) or name in defined or name in FILE_SUFFIXES
            if not is_known and (module in defined or find_spec(module) is None):
                wrong.append(f"{path}: {module}.{name}")
    assert not wrong, wrong


MADE_BY_NEW_LAB = {"lab.launch"}  # a lab's own file, outside this repository
COMMAND = re.compile(r"(?:^ {4,}|`|&& )(?:sudo )?(make|roslaunch|rosrun)((?: +[\w.~/*-]+)+)", re.M)


def missing_commands(text):
    """Lists a page's commands whose make target, launch file or executable of ours does not exist."""
    targets = set(re.findall(r"^([a-z]+):", (TOP / "Makefile").read_text(encoding="utf-8"), re.M))
    missing = []
    for program, rest in COMMAND.findall(text):
        words = rest.split()
        if program == "make":
            exists = words[0] in targets
        elif program == "roslaunch" and words[0].endswith(".launch"):
            exists = (TOP / words[0]).is_file() or (words[0].startswith("~") and Path(words[0]).name in MADE_BY_NEW_LAB)
        elif words[0] in PACKAGES:
            folder = "launch" if program == "roslaunch" else "scripts"
            place = (TOP / "src" / words[0] / folder).resolve()  # roslaunch also looks into subfolders
            exists = len(words) > 1 and any(place.rglob(words[1]))
        else:
            exists = not words[0].startswith("vb_")  # other people's packages
        missing += [] if exists else [f"{program} {' '.join(words[:2])}"]
    return missing


def test_commands_in_pages_exist():
    pages = [path for path in texts() if path.suffix == ".md" and "reference" not in path.parts]
    assert sum(len(COMMAND.findall(path.read_text(encoding="utf-8"))) for path in pages) > 50
    missing = {str(path.relative_to(TOP)): missing_commands(path.read_text(encoding="utf-8")) for path in pages}
    assert not {page: commands for page, commands in missing.items() if commands}


EXAMPLES = "import doctest, importlib, sys; done = doctest.{}; sys.exit(done.failed or not done.attempted)"
WITH_EXAMPLES = [module_name(path) for path in TOP.glob("src/*/src/**/*.py") if ">>> " in path.read_text("utf-8")]


@pytest.mark.parametrize("module", sorted(name for name in WITH_EXAMPLES if name.split(".")[0] not in ALGORITHMS))
def test_examples_run(module):
    run_python("-c", EXAMPLES.format(f"testmod(importlib.import_module('{module}'))"))


def test_the_examples_of_the_readme_run():
    run_python("-c", EXAMPLES.format(f"testfile({str(TOP / 'README.md')!r}, module_relative=False)"))


def test_the_demonstration_needs_only_what_a_container_has():
    blocked = ("pandas", "jinja2", "distributed", "pytest", "hypothesis", "selenium")
    run_python("-c", IMPORT_WITHOUT, ",".join(blocked), "vb_evaluation.demo")


def test_the_analysis_knows_no_simulator():
    """Nothing that measures or reports imports the simulator, so that both can be changed independently."""
    parts = ("statistics.py", "metrics.py", "report/*.py", "user_study/*.py")
    modules = [module_name(path) for part in parts for path in TOP.glob(f"src/vb_evaluation/src/vb_evaluation/{part}")]
    assert len(modules) > len(parts)
    run_python("-c", IMPORT_WITHOUT, "vb_sim,vb_evaluation.simulated_study", *modules)


# ------------------------------------------------------------ what `pip install .` installs
@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Builds the wheel of the working copy's files and unpacks it, without downloads; returns its folder."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in listed_by_git("-co", "--exclude-standard", "pyproject.toml", "README.md", "src"):
        if not (TOP / name).is_symlink():
            (folder / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "source" / name).write_bytes((TOP / name).read_bytes())
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder]
    run_python("-m", "pip", "wheel", *options, folder / "source")
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(str(wheel)).extractall(str(folder / "installed"))
    return folder / "installed"


def test_examples_run_as_installed_without_ros(installed):
    modules = [name for name in WITH_EXAMPLES if name.split(".")[0] in ALGORITHMS]
    assert set(PROMISED) <= set(WITH_EXAMPLES)
    assert {name.split(".")[0] for name in modules} == set(ALGORITHMS)
    run_python("-c", EXAMPLES_AS_INSTALLED, installed, *modules)


def test_no_file_of_the_packages_is_left_out(installed):
    for package in ALGORITHMS:
        inside = TOP / "src" / package / "src"
        kinds = (".py", ".yaml", ".json")
        files = [path for path in inside.rglob("*") if path.suffix in kinds and "ros" not in path.parts]
        wanted = {path.relative_to(inside) for path in files}
        assert wanted, package
        assert [path for path in wanted if not (installed / path).is_file()] == []
