MODULE Scopes
PERS tooldata tGrip:=[TRUE,[[0,0,120],[1,0,0,0]],[1.2,[0,0,60],[1,0,0,0],0,0,0]];
PERS tooldata tTorch:=[TRUE, [[-20,15,200],[0.92387953,0,0.38268343,0]], [2.5,[10,0,90],[1,0,0,0],0,0,0.01]];
CONST robtarget p10:=[[444.1713,110.7544,276.5597],[0.134127152,0.210626339,0.957078269,0.147131365],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
CONST robtarget pA:=[[405.2461,-174.6769,218.5084],[0.006615892,-0.182508885,0.979806734,-0.081397178],[-1,-1,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
CONST robtarget pB:=[[330.8324,-175.178,203.3934],[0.036906629,-0.366321809,-0.928822779,-0.041647068],[-1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
CONST robtarget pT:=[[489.4181,76.6585,-63.7711],[0.135600031,0.238727838,-0.960708613,0.040750603],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS wobjdata wTable:=[FALSE,TRUE,"",[[100,-50,200],[0.9659258,0,0,0.2588190]],[[10,20,30],[1,0,0,0]]];
VAR bool ready:=FALSE;
PROC main()
  CONST robtarget pLocal:=[[511.1235,101.8048,279.6603],[0.072605915,-0.772892962,-0.608688215,-0.163900907],[0,0,1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  First;
  second;
  MoveJ pLocal,v100,fine,tGrip;
  GoTo_Point pA;
  GoTo_Point pB;
  GoTo_Point [[466.5471,228.4064,226.9565],[0.220209857,-0.471256649,0.846339026,0.114608216],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  WithTool pT,tTorch\frame:=wTable;
  IF ready MoveJ p10,v100,fine,tGrip;
  IF NOT ready AND Dim(list,1)>2 GOTO again;
  TEST number
  CASE 1,2: MoveL pA,v100,fine,tGrip;
  CASE 3:
    MoveL pB,v100,fine,tGrip;
  DEFAULT:
    TPWrite "none";
  ENDTEST
again:
  WHILE ready DO
    MoveL p10,v100,fine,tGrip;
  ENDWHILE
  IF ready=TRUE THEN
    MoveJ Point(3),v100,fine,tGrip;
  ELSEIF number=2 THEN
    Elsewhere pA,1;
  ELSE
    rHome;
  ENDIF
  %"Part"+NumToStr(number,0)%;
  CallByVar "proc",number;
ERROR
  IF ERRNO=ERR_PATH_STOP THEN
    MoveJ pA,v50,fine,tGrip;
    TRYNEXT;
  ENDIF
ENDPROC
PROC First()
  CONST robtarget p10:=[[382.687,374.4945,442.2424],[0.608500682,-0.691424468,-0.053524914,-0.385738523],[0,-1,-2,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  MoveJ p10,v100,fine,tGrip;
ENDPROC
LOCAL PROC Second()
  VAR robtarget p10;
  p10:=[[382.687,374.4945,442.2424],[0.608500682,-0.691424468,-0.053524914,-0.385738523],[0,-1,-2,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  MoveJ p10,v100,fine,tGrip;
ENDPROC
PROC GoTo_Point(robtarget point \switch slow)
  MoveJ Offs(point,0,0,100),v500,z10,tGrip;
  MoveL point,v100,fine,tGrip;
ENDPROC
PROC WithTool(robtarget point,PERS tooldata tool\PERS wobjdata frame|num none)
  MoveJ point,v500,z10,tool\WObj:=frame;
ENDPROC
PROC Unused(robtarget point)
  MoveJ point,v500,z10,tGrip;
ENDPROC
FUNC robtarget Point(num i)
  RETURN Offs(p10,i,0,0);
ENDFUNC
TRAP Stopped
  MoveJ pB,v100,fine,tGrip;
ENDTRAP
ENDMODULE
