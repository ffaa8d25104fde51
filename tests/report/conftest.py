import pytest

from tests.report.fake_run import make_run


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """A finished run of three SLAM passes; tests must not change it."""
    return make_run(tmp_path_factory.mktemp("run"), pose_errors=(4.0, 1.5, 1.8), depth_errors=(0.35, 0.2, 0.17))
