# To be sourced, by bash: the environment of this workspace.
#   . scripts/env.sh
# ROS traffic stays on this machine unless ROS_IP (or ROS_HOSTNAME) is set beforehand; ROS_MASTER_URI alone is not enough.
_vb_top=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [ ! -f "$_vb_top/devel/setup.bash" ]; then
    echo "env.sh: the workspace is not built yet: run 'make setup' first" >&2
    return 1
fi
# setup files of ROS read unset variables
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
export PYTHONPATH="$PYTHONPATH:$_vb_top:$_vb_top/test/support"   # for bench/, and what tests share
# Where Python is told not to write bytecode, as in many containers, each start of a node would compile all of its modules
# again, a third of its start; here it is kept out of the sources.
if [ -n "${PYTHONDONTWRITEBYTECODE:-}" ]; then
    unset PYTHONDONTWRITEBYTECODE
    export PYTHONPYCACHEPREFIX=$_vb_top/build/bytecode
fi
# image work is spread over processes, one per camera: threads within each would only fight for the cores
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1}
# Debian's old ROS still says so at each start that a newer one exists
export ROSCONSOLE_FORMAT=${ROSCONSOLE_FORMAT:-'[${severity}] [${node}]: ${message}'}
unset _vb_file _vb_nounset
