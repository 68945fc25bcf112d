# Sets up the environment of this workspace. Source it in bash:
#   . scripts/env.sh
# ROS traffic stays on this machine unless ROS_IP (or ROS_HOSTNAME) is set before; ROS_MASTER_URI alone is not enough.
_vb_top=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [ ! -f "$_vb_top/devel/setup.bash" ]; then
    echo "env.sh: the workspace is not built yet: run 'make setup' first" >&2
    return 1
fi
# ROS's setup files read unset variables
case $- in *u*) _vb_nounset=1; set +u ;; *) _vb_nounset= ;; esac
if [ ! -f /opt/ros/noetic/setup.bash ]; then
    for _vb_file in /etc/catkin/profile.d/*.sh; do . "$_vb_file"; done
fi
. "$_vb_top/devel/setup.bash"
# the real navigation stack, if `make navigation` built it
[ -f "$_vb_top/navigation_ws/devel/setup.bash" ] && . "$_vb_top/navigation_ws/devel/setup.bash" --extend
[ -n "$_vb_nounset" ] && set -u
if [ -z "${ROS_IP:-}${ROS_HOSTNAME:-}" ]; then
    export ROS_IP=127.0.0.1
fi
export ROS_MASTER_URI=${ROS_MASTER_URI:-http://127.0.0.1:11311}
export PATH="$_vb_top/.venv/bin:$PATH"
export PYTHONPATH="$PYTHONPATH:$_vb_top:$_vb_top/test/support"   # for bench/ and the tests' shared modules
# In many containers, Python must not write bytecode, so that each node would compile its modules at every start, which
# takes a third of its starting time. Here bytecode is written to a separate folder.
if [ -n "${PYTHONDONTWRITEBYTECODE:-}" ]; then
    unset PYTHONDONTWRITEBYTECODE
    export PYTHONPYCACHEPREFIX=$_vb_top/build/bytecode
fi
# images are processed by one process per camera; more threads would only compete for the cores
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1}
# log messages name the node instead of the time
export ROSCONSOLE_FORMAT=${ROSCONSOLE_FORMAT:-'[${severity}] [${node}]: ${message}'}
unset _vb_file _vb_nounset
